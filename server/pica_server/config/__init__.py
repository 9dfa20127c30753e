"""What an operator may set, and where a setting came from."""
