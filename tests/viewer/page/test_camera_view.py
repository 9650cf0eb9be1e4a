"""The camera view draws what the recorded camera would see, also of what is beside or behind it."""

import json
import shutil
import subprocess
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import FRAME, WatchedPage
from numpy.typing import NDArray
from page_blocks import unpack

from mast_zenoh.arrays.geometry import box_corners, to_local, to_world
from mast_zenoh.arrays.states import Floats
from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.camera import clip_polygon
from mast_zenoh.show.page.block import run_block

pytestmark = pytest.mark.heavy

OpenPage = Callable[..., WatchedPage]

#: m, the viewer's near plane.
NEAR = 0.5
#: Corners of `box_corners` by the names of faces.
FACES = {
    "front": (0, 3, 7, 4),
    "back": (1, 2, 6, 5),
    "left": (0, 1, 5, 4),
    "right": (3, 2, 6, 7),
    "top": (4, 5, 6, 7),
    "bottom": (0, 1, 2, 3),
}


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_random_polygons_are_cut_as_numpy_cuts_them() -> None:
    rng = np.random.default_rng(3)
    polygons = [rng.normal(0.0, 10.0, (count, 3)) for count in rng.integers(3, 9, 40).tolist()]
    module = Path(str(resources.files("mast_zenoh.show.page") / "js" / "perspective.js")).as_uri()
    points = json.dumps([polygon.tolist() for polygon in polygons])
    script = f"""import {{ clipPolygon }} from "{module}";
    console.log(JSON.stringify({points}.map((polygon) => clipPolygon(polygon, (point) => point[0] - {NEAR}))));"""
    ended = subprocess.run(
        ["node", "--input-type=module", "-e", script], capture_output=True, text=True, timeout=60, check=True
    )
    for polygon, found in zip(polygons, json.loads(ended.stdout), strict=True):
        assert np.reshape(found, (-1, 3)) == pytest.approx(clip_polygon(polygon, polygon[:, 0] - NEAR))


class RecordedCamera:
    """The camera of an agent in a frame, from the recording alone."""

    def __init__(self, run: Run, agent: str, frame: int) -> None:
        index = run.files.scene.agent_names.index(agent)
        self.camera = run.files.scene.agents[index].camera
        self.object = run.files.scene.agents[index].object_id
        self.position = run.files.scene.agent_position[frame, index]
        self.rotation = run.files.scene.agent_rotation[frame, index]

    @property
    def eye(self) -> Floats:
        return to_world(self.camera.mount_position[None], self.position, self.rotation)[0]

    def project(self, corners: Floats) -> tuple[Floats, Floats]:
        """Pixels and depths of the part of a polygon beyond the near plane."""
        _, depth = self.camera.project(corners, self.position, self.rotation)
        return self.camera.project(clip_polygon(corners, depth - NEAR), self.position, self.rotation)


def camera_marks(page: WatchedPage, frame: int, agent: str, estimate: str) -> dict[str, Any]:
    page.run(
        "([frame, agent, estimate]) => {"
        " viewer.state.seek(frame); viewer.state.choose(0, { agent, estimate, eye: 'camera' }); }",
        [frame, agent, estimate],
    )
    marks: dict[str, Any] = page.run("viewer.marks(0)")
    assert (marks["frame"], marks["camera"]["agent"]) == (frame, agent)
    return marks


def same_outline(found: NDArray[Any], expected: Floats, tolerance: NDArray[Any]) -> bool:
    """Whether each expected corner is near a found one, and the other way round; (n,) px."""
    apart = np.linalg.norm(found[:, None] - expected[None], axis=2)
    return bool((apart.min(axis=0) <= tolerance).all() and (apart <= tolerance).any(axis=1).all())


def test_boxes_are_projected_as_the_recorded_camera_does(
    report: Path, attacked_run: Path, loaded_run: Run, open_page: OpenPage
) -> None:
    page = open_page(report)
    table = read_table(attacked_run / "objects.parquet")
    faces = cut = own = 0
    views = (("ego", "picture"), ("ego", "mission"), ("infra_1", "local"), ("infra_3", "picture"))
    for frame in (22, FRAME):
        for agent, estimate in views:
            recorded = RecordedCamera(loaded_run, agent, frame)
            camera = camera_marks(page, frame, agent, estimate)["camera"]
            here = (table["frame"] == frame) & (table["agent"] == agent) & (table["estimator"] == estimate)
            drawn = {(solid["kind"], solid["id"]): solid for solid in camera["boxes"]}
            distances = [solid["distance"] for solid in camera["boxes"]]
            assert distances == sorted(distances, reverse=True), "the farthest is drawn first"
            for row in np.flatnonzero(here):
                place, size = (np.array([[table[name][row] for name in names]]) for names in ("xyz", "lwh"))
                corners = box_corners(place, size, table["yaw"][row : row + 1])[0]
                solid = drawn.pop((table["kind"][row], int(table["id"][row])), None)
                carrier = table["id" if table["kind"][row] == "truth" else "match_id"][row]
                if agent == "ego" and carrier == recorded.object:
                    assert solid is None, "the vehicle that carries the camera is not drawn"
                    own += 1
                    continue
                found = {face["side"]: face["polygon"] for face in solid["faces"]} if solid else {}
                for side, places in FACES.items():
                    pixels, depth = recorded.project(corners[list(places)])
                    if len(pixels) < 3 or depth.max() < NEAR + 0.1:
                        continue
                    # Rounded by at most 0.02 m and 0.002 rad in the page's data.
                    reach = np.linalg.norm(corners - recorded.eye, axis=1).max()
                    slant = 1 + np.abs(pixels - [400, 300]).max(axis=1) / recorded.camera.focal
                    tolerance = recorded.camera.focal / depth * (0.02 + 0.004 * reach) * slant
                    assert same_outline(np.array(found[side]), pixels, tolerance), (frame, agent, estimate, side)
                    faces += 1
                    cut += bool(depth.min() < NEAR + 1e-6)
            assert not drawn
    assert faces > 1000
    assert cut > 0, "expected boxes across the near plane"
    assert own > 0


def test_places_around_a_camera_never_fold_over(report: Path, loaded_run: Run, open_page: OpenPage) -> None:
    page = open_page(report)
    block = run_block(loaded_run)
    header, columns = unpack(block)
    rng = np.random.default_rng(5)
    for index, agent in enumerate(header["agents"]):
        at = index * header["frames"] + FRAME
        yaw, pitch, roll = (columns[f"agents.{name}"][at] for name in ("yaw", "pitch", "roll"))
        turns = [np.cos(each) for each in (yaw, pitch, roll)], [np.sin(each) for each in (yaw, pitch, roll)]
        (cy, cp, cr), (sy, sp, sr) = turns
        rotation = (
            np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
            @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
            @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        )
        recorded = RecordedCamera(loaded_run, agent["name"], FRAME)
        assert rotation == pytest.approx(recorded.rotation, abs=0.004)
        recorded.rotation = rotation  # as rounded, so that pixels can be compared closely
        recorded.position = np.array([columns[f"agents.{name}"][at] for name in "xyz"])
        camera_marks(page, FRAME, agent["name"], "picture")
        # Boxes around the camera, passing it, and with corners right beside it.
        places = recorded.eye + rng.normal(0.0, 2.5, (25, 3))
        boxes = box_corners(places, rng.uniform(0.3, 12.0, (25, 3)), rng.uniform(-3.0, 3.0, 25))
        polygons = [box[list(corners)].tolist() for box in boxes for corners in FACES.values()]
        drawn = page.run("(places) => places.map((each) => viewer.marks(0).camera.lens.polygon(each))", polygons)
        for polygon, pixels in zip(polygons, drawn, strict=True):
            expected, depth = recorded.project(np.array(polygon))
            assert np.reshape(pixels, (-1, 2)) == pytest.approx(expected, rel=1e-6, abs=1e-3)
            assert (depth >= NEAR - 1e-9).all()
            local = to_local(np.array(polygon), recorded.eye, rotation @ recorded.camera.mount_rotation)
            on_left = local[local[:, 0] > NEAR]
            if len(on_left) == len(local) and (local[:, 1] > 0.01).all():
                assert expected[:, 0].max() < recorded.camera.width / 2


def test_layers_change_the_camera_view(report: Path, open_page: OpenPage) -> None:
    page = open_page(report, width=1300)
    camera_marks(page, FRAME, "infra_2", "picture")
    image = "viewer.panels[0].canvas.toDataURL()"
    toggle = "(name) => viewer.state.set({ layers: { ...viewer.state.layers, [name]: !viewer.state.layers[name] } })"
    for layer in ("ids", "trails", "velocity", "ellipses", "ranges", "manipulations", "paths"):
        page.settle()
        before = page.run(image)
        page.run(toggle, layer)
        page.settle()
        assert page.run(image) != before, layer
        page.run(toggle, layer)
        page.settle()
        assert page.run(image) == before, layer
