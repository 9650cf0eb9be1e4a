"""MP4 (H.264) and WebM (VP9) by ffmpeg, which the package imageio-ffmpeg carries."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path

from mast_zenoh.errors import ExportError
from mast_zenoh.report.film.pixels import Pixels

#: By kind of file. The number of threads is fixed, because encoders divide their work by it.
_ENCODERS = {
    "mp4": ("-c:v", "libx264", "-preset", "medium", "-crf", "18", "-threads", "2", "-movflags", "+faststart"),
    "webm": (
        "-c:v",
        "libvpx-vp9",
        "-crf",
        "24",
        "-b:v",
        "0",
        "-deadline",
        "realtime",
        "-cpu-used",
        "6",
        "-row-mt",
        "1",
        "-threads",
        "2",
    ),
}
#: Neither dates nor versions, so that equal images give equal files.
_NO_METADATA = ("-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact")


def ffmpeg() -> str:
    """The path of ffmpeg: that of the package imageio-ffmpeg, or else the one on PATH.

    Raises ExportError if there is neither.
    """
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):  # the package is there, but without a program for this machine
        path = shutil.which("ffmpeg")
    if path is None:
        raise ExportError(
            "found neither the package imageio-ffmpeg nor ffmpeg on PATH: expected one of them for MP4 and WebM: "
            "pip install 'mast-zenoh[film]'; a name that ends with .gif needs neither"
        )
    return path


def write_video(path: Path, images: Iterable[Pixels], size: tuple[int, int], fps: float) -> None:
    """Write a film. size: width and height in px, both even

    Raises ExportError if ffmpeg is absent or fails, for example because it lacks the encoder.
    """
    width, height = size
    source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:.6g}", "-i", "-")
    colours: tuple[str, ...] = (
        "-vf",
        "scale=out_color_matrix=bt709:out_range=tv",
        "-colorspace",
        "bt709",
        "-color_primaries",
        "bt709",
    )
    colours = (*colours, "-color_trc", "bt709", "-color_range", "tv", "-pix_fmt", "yuv420p")
    encoder = _ENCODERS[path.suffix.lower().removeprefix(".")]
    program = ffmpeg()
    command = [program, "-nostdin", "-v", "error", "-y", *source, "-an", *colours, *encoder, *_NO_METADATA, str(path)]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors)
        assert process.stdin is not None
        try:
            for image in images:
                process.stdin.write(image.tobytes())
            process.stdin.close()
        except BrokenPipeError:  # it has ended: its error output says why
            pass
        except BaseException:
            process.kill()
            raise
        finally:
            code = process.wait()
        if code:
            errors.seek(0)
            words = errors.read().decode(errors="replace").strip().splitlines()
            raise ExportError(f"{path.name}: {program} failed with exit code {code}: {' '.join(words[-3:])}")
