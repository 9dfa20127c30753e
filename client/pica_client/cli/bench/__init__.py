"""The commands of `pica bench`, one module each."""
