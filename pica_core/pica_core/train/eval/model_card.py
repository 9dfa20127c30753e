"""What an avatar file says of its making: data, training, held-out error (the model card)."""

import json
from pathlib import Path

from pica_core.train.eval.evaluate import mean_mse
from pica_core.train.loop import Trainer

EVALUATION_FILE = "evaluation.json"


def model_card(trainer: Trainer, run: Path) -> dict[str, str]:
    """Entries in words, for `pica avatar info` and readers of the file; nothing of errors where
    the run's folder has no evaluation."""
    model, data = trainer.config.model, trainer.data
    camera = data.capture.cameras[0]
    seconds = f", {trainer.seconds / 60:.0f} minutes" if trainer.seconds >= 60 else ""
    card = {
        "capture": str(data.capture.info["source"]),
        "frames": f"{len(data.train_frames)} to train on, {len(data.test_frames)} held out, "
        f"{len(data.capture.cameras)} cameras of {camera.width} x {camera.height}",
        "training": f"{trainer.step} of {trainer.total_steps} steps, seed {trainer.config.seed}"
        + seconds,
        "variant": model.variant,
        "block": model.block,
        "encoder": model.encoder,
    }
    path = run / EVALUATION_FILE
    if not path.exists():
        return card
    rows = json.loads(path.read_text())
    views = [f"{row['view']} {row['mse']:.1f}" for row in rows if row["source"] == "encoder"]
    card["held_out_mse"] = f"{mean_mse(rows):.1f} (0-255, rasterised pixels): {', '.join(views)}"
    card["vertex_error"] = f"{rows[0]['vertex_error_mm']:.2f} mm on average"
    if (driven := mean_mse(rows, "driver")) is not None:
        card["held_out_mse_live"] = f"{driven:.1f}, sent from ARKit values"
    return card
