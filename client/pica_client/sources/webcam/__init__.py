"""A face by a plain webcam: three networks find it, its landmarks and its shapes."""
