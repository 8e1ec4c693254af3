"""Starting, watching and stopping the stack on one machine."""
