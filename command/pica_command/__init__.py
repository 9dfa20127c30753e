"""The `pica` command: finds its sub-commands in a table and imports the one that is called."""
