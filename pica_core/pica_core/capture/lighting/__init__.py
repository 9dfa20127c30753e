"""How much light reaches each vertex of a head or rig."""
