"""Microphone and loudspeaker of this machine, and the process that they live in."""
