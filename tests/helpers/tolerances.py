"""How closely two implementations of one thing must agree, and why just so: the one table.

Errors are absolute, in the unit of the row. Each bound is a few times what was measured on random
avatars with weights as large as trained ones, so a rounding change passes and a wrong formula does
not.
"""

PIXEL_FLOAT32 = 1e-3
"""RGB 0..1, torch float32 against numpy float64. A place in the 10,000-entry tables m_u, m_v is
exact to 5e-4 of an entry in float32, and neighbouring entries may differ by 2; the rest is rounding
through four sine layers (measured 3e-4; 1e-5 with tables of 200)."""

PIXEL_GLSL = 1.0 / 255
"""RGB 0..1, GLSL under llvmpipe against numpy float64 on the positions and UVs that the first pass
stored, read back in 8 bits. Half a step is the rounding of the target; the other half leaves room
for 16-bit encoding maps (5e-4 of their range), llvmpipe's sine and float32 places in tables
(measured 0.504 steps)."""

MAP_TORCH_M = 2e-6
"""Position map in metres, ONNX against torch: float32 rounding through 15 layers, times the scale
of a few millimetres, plus one rounding at 0.1 m (measured 1e-8)."""

MAP_ONNX_M = 2e-7
"""Position map in metres, rearranged ONNX graph against the numpy interpretation in float64
(measured 2e-8)."""

EXPRESSION_ONNX = 2e-5
"""Expression map, unitless, values up to about 3: float32 sums of up to 288 products, reordered
(measured 2e-6)."""

GOLDEN_IMAGE = 1.0 / 255
"""Golden images: one step per channel, same llvmpipe; compilers may contract multiply-adds
differently."""

EXPRESSION_GLSL = 1e-5
"""Expression map, unitless, values up to about 3, shaders against numpy float64: as
EXPRESSION_ONNX, with room for GPUs that fuse or order sums otherwise (measured 3.3e-7 under
llvmpipe)."""

MAP_GLSL_M = 1e-7
"""Vertices in metres, shaders against numpy float64: one rounding at 0.1 m after a sum of at
most 41 directions of a few millimetres (measured 3e-8)."""
