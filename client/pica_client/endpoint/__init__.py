"""The ends of a call: what runs a link, feeds a call with it, and says how the call stands."""
