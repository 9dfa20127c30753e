"""The avatar files of a client: shipped, named by the user, fetched from a relay, uploaded."""
