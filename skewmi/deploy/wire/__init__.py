"""What goes over the wire: messages, keys, sessions."""

from skewmi.deploy.wire import runtime

# Before anything else of ours can open a Zenoh session.
runtime.prepare()
