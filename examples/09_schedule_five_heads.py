"""Schedule five heads within a budget: who gets which level of detail, and who is decoded anew.

You learn what a receiver decides for each drawn frame. The scheduler is pure: heads as they
stand before the camera go in, choices come out. The less there is to spend, the more is kept
from heads that are small or hardly move; what cannot be seen costs nothing.
"""

from pica_client.schedule.error_model import ErrorModel
from pica_client.schedule.scheduler import HeadView, Scheduler
from pica_core.avatar.levels import default_errors

LEVELS = (64, 128, 256)
TRIANGLES = (4_000, 16_000, 50_000)  # of the mesh of each level
ERRORS = ErrorModel(default_errors(LEVELS))
HEIGHTS_PX = {"Ada": 420, "Ben": 260, "Cho": 140, "Dee": 24, "Eve": 0}  # Eve is off the screen

heads = [
    HeadView(
        slot=name,
        errors=ERRORS,
        num_triangles=TRIANGLES,
        is_visible=height_px > 0,
        visible_px=0.6 * height_px**2,
        head_px=height_px,
        held_level=64,  # what was decoded a moment ago, a tenth of a second old
        age_s=0.1,
        latent_change=0.3,
    )
    for name, height_px in HEIGHTS_PX.items()
]

for budget_ms in (100, 24, 16):
    plan = Scheduler().plan(heads, budget_ms / 1000, now=1.0)
    print(f"budget {budget_ms} ms: cost {plan.cost_s * 1000:.1f} ms, error {plan.error:.1f}")
    for name, height_px in HEIGHTS_PX.items():
        choice = plan.choices[name]
        print(
            f"  {name}: {height_px:3d} px, decode {choice.decode:10} at {choice.level:3d}, "
            f"mesh {choice.mesh_level:3d}, stream layer {choice.wanted_layer}"
        )
