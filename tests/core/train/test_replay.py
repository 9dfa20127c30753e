"""Steps that a CUDA graph could repeat, and what repeats them, without a GPU."""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.nn import Parameter
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from pica_core.avatar.spec import VARIANTS
from pica_core.train.config import PRESETS, TrainConfig
from pica_core.train.data import TrainingData
from pica_core.train.objectives import Draw
from pica_core.train.raster import Capacity, TensorRasteriser
from pica_core.train.replay import WARM_UP, ReplayedStep
from pica_core.train.train import Trainer

pytestmark = [pytest.mark.train, pytest.mark.usefixtures("one_thread")]

WAITING = ("_local_scalar_dense", "nonzero", "bincount", "masked_select", "unique", "lift_fresh")
"""Operations that read a tensor's values on the CPU, or copy Python's into a tensor."""


class Watcher(TorchDispatchMode):
    """Collects what a CUDA graph could not hold: operations of `WAITING`, and tensors that neither
    were there before nor came out of an operation, as those of a list used as an index."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        # Storages by address; kept alive, so that no address comes twice.
        self._kept = [each for each in gc.get_objects() if type(each) in (Tensor, Parameter)]
        self._known = {each.untyped_storage().data_ptr() for each in self._kept}

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        given = [each for each in tree_leaves((args, kwargs)) if isinstance(each, Tensor)]
        strange = [each for each in given if each.untyped_storage().data_ptr() not in self._known]
        if name in WAITING or strange:
            self.found.append(name)
        result = func(*args, **(kwargs or {}))
        for each in tree_leaves(result):
            if isinstance(each, Tensor):
                self._kept.append(each)
                self._known.add(each.untyped_storage().data_ptr())
        return result


@contextmanager
def opened(data: TrainingData, config: TrainConfig, out: Path) -> Iterator[Trainer]:
    """A trainer that rasterises as on a GPU."""
    faces = data.meshes.topology(VARIANTS[config.variant].topology).faces
    yield Trainer(data, config, out, TensorRasteriser(faces, "cpu"))


@pytest.mark.parametrize(
    ("preset", "variant"), [("paper", "full"), ("tiny", "baseline"), ("tiny", "linear")]
)
def test_a_step_of_fixed_lengths_reads_nothing_back(
    data: TrainingData, tmp_path: Path, preset: str, variant: str
) -> None:
    config = replace(PRESETS[preset], variant=variant, encoder="light", uv_encoding_size=64)
    with opened(data, replace(config, geometry_steps=0, texture_size=128), tmp_path) as trainer:
        trainer.train_step()
        batch = trainer.objectives.prepare("joint", Draw(0, 1))
        drawer = trainer.objectives.drawer
        assert isinstance(drawer.rasteriser, TensorRasteriser)
        drawer.capacity.fix()
        drawer.rasteriser.capacity.fix()

        with Watcher() as watcher:
            trainer.objectives.joint(batch)

    assert watcher.found == []


def test_a_resumed_run_of_another_machine_goes_on_from_half_precision(
    data: TrainingData, tmp_path: Path
) -> None:
    config = replace(PRESETS["tiny"], texture_contrast=0.0, geometry_steps=0)
    (tmp_path / "light").mkdir()
    with opened(data, config, tmp_path / "run") as trainer:
        trainer.train_step()
        trainer.save()
        trainer.save(tmp_path / "light", light=True)
        after = trainer.train_step()

    with opened(data, config, tmp_path / "other") as trainer:
        trainer.restore(tmp_path / "light")
        losses = trainer.train_step()

    sizes = [(tmp_path / run / "checkpoint.pt").stat().st_size for run in ("light", "run")]
    assert sizes[0] < 0.4 * sizes[1]
    assert losses["mesh"] == pytest.approx(after["mesh"], rel=0.05)


class FakeGraph:
    """Repeats what was captured by doing it again: torch's needs a GPU."""

    work: Callable[[], None]

    def replay(self) -> None:
        self.work()


def test_a_replayed_step_makes_room_for_what_it_had_to_leave_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    graphs: list[FakeGraph] = []
    capacity = Capacity(1.5)
    done: list[tuple[float, int]] = []

    def work(batch: dict[str, Tensor]) -> Tensor:
        length = capacity.of(batch["count"])
        done.append((float(batch["value"]), length))
        return batch["value"].view(1).clone()

    @contextmanager
    def capture(graph: FakeGraph, **_: object) -> Iterator[None]:
        graphs.append(graph)
        yield
        done.pop()  # a capture does nothing
        room = capacity._room

        def again() -> None:
            done.append((float(step._batch["value"]), room))
            step._values.copy_(step._batch["value"])
            step._needed[0][1].copy_(step._batch["count"])

        graph.work = again

    monkeypatch.setattr(torch.cuda, "Stream", lambda _: NoStream())
    monkeypatch.setattr(torch.cuda, "current_stream", lambda _: NoStream())
    monkeypatch.setattr(torch.cuda, "stream", lambda _: nullcontext())
    monkeypatch.setattr(torch.cuda, "CUDAGraph", FakeGraph)
    monkeypatch.setattr(torch.cuda, "graph", capture)
    step = ReplayedStep(work, [capacity], torch.device("cpu"))

    counts = [4, 6, 6, 7, 10, 8]  # the fifth, replayed, finds room for nine
    for value, count in enumerate(counts):
        found = step({"value": torch.tensor(float(value)), "count": torch.tensor(count)})
        assert float(found[0]) == value

    assert WARM_UP == 3
    assert done == [(0, 4), (1, 6), (2, 6), (3, 9), (4, 9), (5, 15)]
    assert len(graphs) == 2


class NoStream:
    """Stands for a stream of a GPU."""

    def wait_stream(self, _: "NoStream") -> None:
        """Nothing runs beside anything."""
