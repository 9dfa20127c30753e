"""Latents to position and expression maps, by ONNX Runtime, off the drawing thread."""
