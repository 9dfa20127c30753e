"""One module for each command of the client: options in, parts put together, results out."""
