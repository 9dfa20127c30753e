"""GL side of the built-in heads: drawn as rigs are, with what is known of them."""

from pica_core.capture.procedural.features import grown_hair, look
from pica_core.capture.procedural.heads import ProceduralHead
from pica_core.capture.rig.gpu import RigRenderer
from pica_core.capture.stage.gpu import BAKE_SIZE


class ProceduralRenderer(RigRenderer):
    """Draws one built-in head; `occlusion` False leaves out self-shadowing, which takes seconds."""

    def __init__(
        self, head: ProceduralHead, *, bake_size: int = BAKE_SIZE, occlusion: bool = True
    ) -> None:
        growth = grown_hair(head.identity, head.charts, head.rest_m, head.features)
        numbers = look(head.identity)
        super().__init__(head, {}, numbers, growth, bake_size=bake_size, occlusion=occlusion)
