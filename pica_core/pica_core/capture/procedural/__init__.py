"""The built-in heads, each made from a row of numbers."""
