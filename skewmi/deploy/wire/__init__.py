"""What goes over the wire: messages, keys, sessions."""
