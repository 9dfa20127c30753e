"""What each avatar gets in a frame: level of detail, mesh, decode rate, share of its stream."""
