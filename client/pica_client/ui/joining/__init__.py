"""Before the call: the form, what is wrong with it, invite links, and the way into the room."""
