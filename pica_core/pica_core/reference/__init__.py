"""The arithmetic of an avatar in plain numpy: the judge of torch, ONNX and GLSL."""
