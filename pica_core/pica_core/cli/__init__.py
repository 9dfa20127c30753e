"""The commands of the avatar and of captures that need no torch."""
