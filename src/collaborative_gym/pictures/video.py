"""Files of videos and pictures, which are there whole or not at all."""

import io
import subprocess
from collections.abc import Iterable, Iterator
from contextlib import suppress
from importlib import import_module
from itertools import chain, islice
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np

from collaborative_gym.errors import how_to_install
from collaborative_gym.files import naming, replacing

_BEGIN = 100  # frames of a GIF by which its colours are chosen

Frames = Iterator[np.ndarray]
"""Pictures, (height, width, 3) uint8."""


def _write_mp4(output: Path, frames: Frames, rate: float) -> None:
    program = import_extra("imageio_ffmpeg").get_ffmpeg_exe()
    with replacing(output) as partial, TemporaryFile() as said:
        first = next(frames)
        command = [
            *(program, "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"),
            *("-s", f"{first.shape[1]}x{first.shape[0]}", "-r", f"{rate:g}", "-i", "-"),
            *("-codec:v", "libx264", "-crf", "25", "-pix_fmt", "yuv420p", partial),
        ]
        encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said)
        try:
            _feed(encoder, chain([first], frames))
            if status := encoder.wait():
                said.seek(0)
                words = said.readline().decode(errors="replace").rpartition("] ")[-1]
                why = words.strip() or f"it ended with status {status}"
                raise OSError(f"cannot write {output}: ffmpeg failed: {why}")
        finally:
            encoder.kill()
            encoder.wait()


def _feed(encoder: subprocess.Popen[bytes], frames: Iterable[np.ndarray]) -> None:
    """Give an encoder frames to their end, or until the encoder itself ends."""
    assert encoder.stdin is not None
    for frame in frames:
        try:
            encoder.stdin.write(frame.tobytes())
        except OSError:
            break
    with suppress(OSError):
        encoder.stdin.close()


def _write_gif(output: Path, frames: Frames, rate: float) -> None:
    image = import_extra("PIL.Image")
    with replacing(output) as partial:
        # One palette for all frames: one for each makes colours flicker. Most of it is
        # that of the largest areas, the rest that of what is small or comes later.
        begin = list(islice(frames, _BEGIN))
        sample = image.fromarray(np.concatenate(begin[:: len(begin) // 8 + 1]))
        palette = image.new("P", (1, 1))
        parts = sample.quantize(208), sample.quantize(48, image.Quantize.MAXCOVERAGE)
        palette.putpalette([c for part in parts for c in part.getpalette()])
        options = {"palette": palette, "dither": image.Dither.NONE}
        all_frames = map(image.fromarray, chain(begin, frames))
        shots = (frame.quantize(**options) for frame in all_frames)
        first = next(shots)
        more = {"append_images": shots, "duration": round(1000 / rate), "loop": 0}
        save(first, partial, output, format="GIF", save_all=True, **more)


def save(image: Any, partial: Path, output: Path, **options: Any) -> None:
    """Write a picture to a part file; errors name the file that was asked for."""
    content = io.BytesIO()  # Frames are drawn meanwhile, whose errors are others.
    image.save(content, **options)
    with naming(output):
        partial.write_bytes(content.getvalue())


FORMATS = {".mp4": (_write_mp4, 2, (1280, 720)), ".gif": (_write_gif, 1, (416, 234))}
"""Writers of a kind of video file, pictures per control step in real time, and default
sizes in pixels."""


def import_extra(name: str) -> Any:
    """Return a module of the extra `video`; raise ImportError if it is missing."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(
            f"videos and pictures need {name.split('.')[0]}, which is not installed;"
            f" {how_to_install('video')}"
        ) from error
