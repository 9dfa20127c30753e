"""A capture as tensors: its meshes, its images behind a cache, and which frames are drawn."""
