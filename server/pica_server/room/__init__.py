"""All that a relay decides about rooms and peers. Pure: no socket, no clock."""
