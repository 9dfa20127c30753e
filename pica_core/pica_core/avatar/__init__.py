"""The avatar file, its sizes, its variants and its levels of detail."""
