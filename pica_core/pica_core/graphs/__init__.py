"""Decoders as ONNX graphs, built from checked numbers and never read from a file."""
