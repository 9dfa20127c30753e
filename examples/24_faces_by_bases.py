"""Find the shapes that a face is made of, and see where no small number of them is enough.

You learn what `pica train` does before its first step: mean and principal components of training
meshes, how many of them a head needs, and how it is noticed that a capture bends: a furrow that is
drawn across the skin is another shape at every place.
"""

import numpy as np

from pica_core.avatar.arkit import ARKIT_INDEX
from pica_core.capture.person.choices import draw_person
from pica_core.capture.person.subject import make_head
from pica_core.capture.stage.expressions import sample_takes
from pica_core.model.bases import BENT_M, fit_bases, split_bases, unexplained_m

head, _ = make_head(draw_person(7), coarse=True)
arkit = np.concatenate([take.arkit for take in sample_takes(128, 0)])
plain_m = np.stack([head.vertices(values) for values in arkit])
alike = np.ones(plain_m.shape[1], np.float32)

print("bases  held-out error  in a file")
for count in (16, 64):
    bases = fit_bases(plain_m[:96], count, alike)
    found_m = bases.positions(bases.weights_of(plain_m[96:]))
    error_mm = 1e3 * np.linalg.norm(found_m - plain_m[96:], axis=2).mean()
    parts = split_bases(bases, head.topology.vertex_uv)
    stored = parts.basis.size + 2 * parts.mix_m.size  # directions in 8 bits, their mix in 16
    print(f"{len(bases.components_m):5d} {error_mm:12.3f} mm {stored / 1e6:7.2f} MB")

# The same face with a furrow in each cheek, 4 mm deep, that smiles draw and an opening jaw turns.
furrowed_m = plain_m.copy()
x, y, z = plain_m[0].T
smile = arkit[:, ARKIT_INDEX["mouthSmileLeft"], None]
jaw = arkit[:, ARKIT_INDEX["jawOpen"], None]
beside = (np.abs(x) - 0.025 - 0.034 * smile - 2 * jaw * (y + 0.03)) / 0.002
near = (np.abs(y + 0.03) < 0.03) & (z > 0.03)
furrowed_m[..., 2] += 0.004 * smile * near * (beside**2 - 1) * np.exp(-(beside**2) / 2)

for name, meshes_m in (("plain", plain_m), ("with a furrow", furrowed_m)):
    left_m = unexplained_m(meshes_m, 64, alike, head.topology.vertex_uv)
    answer = "it bends, or frames are too few" if left_m > BENT_M else "bases are enough"
    print(f"{name}: 64 bases of three in four meshes leave {1e3 * left_m:.2f} mm: {answer}")
