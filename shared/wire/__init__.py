"""The traffic of the link: messages, their encoding with every check, and the table of channels."""
