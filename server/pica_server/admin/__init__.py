"""What an admin may ask of a relay over HTTP."""
