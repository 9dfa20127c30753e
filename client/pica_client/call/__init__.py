"""The receiving half of a call: participants, their streams, and how the call stands."""
