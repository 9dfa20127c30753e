"""The page: modules for a browser."""
