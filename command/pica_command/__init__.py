"""The `pica` command: finds its sub-commands by entry point and knows none of them."""
