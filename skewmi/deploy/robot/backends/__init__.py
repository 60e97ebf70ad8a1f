"""The robots that a server can command."""
