"""Schedule five heads within a budget: who gets which level of detail, and who is decoded again.

You learn what a receiver decides for each drawn frame. The scheduler is pure: heads as they
stand before the camera go in, choices come out. The less there is to spend, the smaller every
head counts; what cannot be seen costs nothing.
"""

from pica_client.schedule.head import Head
from pica_client.schedule.scheduler import Scheduler
from pica_client.schedule.visibility import Sight
from pica_core.avatar.file import load_avatar, shipped_avatar_files

HEIGHTS_PX = {"Ada": 520, "Ben": 260, "Cho": 140, "Dee": 24, "Eve": 0}  # Eve is off the screen

avatar = load_avatar(shipped_avatar_files()[0])

for budget_ms in (100, 24, 16):
    heads = [
        Head(
            slot=name,
            avatar=avatar,
            sight=Sight(
                visible_px=0.6 * height_px**2,
                head_px=height_px,
                num_views=int(height_px > 0),
            ),
            latent_change=0.3,  # root mean square over the latent since the last decode
        )
        for name, height_px in HEIGHTS_PX.items()
    ]
    plan = Scheduler().plan(heads, budget_ms / 1000, now=1.0)
    print(f"budget {budget_ms} ms: cost {plan.cost_s * 1000:.1f} ms")
    for name, height_px in HEIGHTS_PX.items():
        choice = plan.choices[name]
        print(
            f"  {name}: {height_px:3d} px, decode {choice.decode:10} at {choice.level:3d}, "
            f"every {choice.every}. face"
        )
