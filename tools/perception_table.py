"""How well perception sees, measured on random scenes against the simulator; the tables of docs/evidence/perception.md.

    python tools/perception_table.py [--seeds 6000-6039] [--docs docs/evidence/perception.md]

Bodies in turn, comfort angle, skin tone, clothes, hair and light by seed. Each scene is seen three times from
overhead: robot parked, robot parked with sensor noise, and with the tool 60 mm above each region in turn; and once from
the wrist, robot parked. Development used seeds below 1000; 5000-5039 were measured once before ``LimbSight.ahead`` was
there. Scenes that were measured with other code, rules, body or packages are measured again.
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import json
import sys
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import carecontact
from carecontact.episode.perception import PerceptionLog, middle_share, true_target
from carecontact.episode.randomization import randomize_appearance, sensor_noise, settle, streams
from carecontact.human.library import body_names
from carecontact.human.skin import SKIN_TONES, draw_appearance
from carecontact.interface.observation import Observation
from carecontact.interface.policy import PolicyCard
from carecontact.interface.regions import STANDARD_REGIONS
from carecontact.protocol.load import load_protocol
from carecontact.protocol.overrides import overridden
from carecontact.protocol.protocol import Protocol
from carecontact.protocol.sections import Variation
from carecontact.recording.notes import JOINTS
from carecontact.sensing.builder import ObservationBuilder
from carecontact.sensing.keypoints import KeyPoints, PoseEstimator
from carecontact.sim.rendering import SceneRenderer
from carecontact.sim.simulation import Simulation
from carecontact.world.arm_kinematics import Arm, pointing_down
from carecontact.world.draws import posture_of
from carecontact.world.scene import build_scene
from reachability import inverse

Row = dict[str, Any]

CARD = PolicyCard(name="table", modalities=("rgb", "depth", "points", "masks", "landmarks"))
ON_WRIST = PolicyCard(name="table", modalities=CARD.modalities, cameras=("wrist",))
SURE = 0.5
"""Visibility from which a landmark counts as one that the estimator claims to see."""
VARIED = Variation(appearance="varied-v1", light="varied-v1")
NOISE = {"depth_noise": "structured-light-v1", "encoder_noise_rad": 0.003}
OVER_M = 0.060
LANDMARK_PX, IOU_MEAN, IOU_MIN, TARGET_MM, TARGET_P95_MM = 6.0, 0.95, 0.85, 15.0, 45.0
"""The lines that the parked robot's numbers are held against."""
BEGIN, END = "<!-- tables: tools/perception_table.py -->", "<!-- end of tables -->"
SOURCES = (
    "interface", "protocol", "sensing", "recording", "policies/motion.py", "policies/state_machine.py", "sim", "human",
    "tissue", "world", "episode/perception.py", "episode/randomization.py",
)  # fmt: skip
"""Of the package, what a row depends on."""
PACKAGES = ("ai-edge-litert", "mujoco", "numpy", "pillow")
CONDITIONS = {"parked": "Robot parked", "noise": "Robot parked, sensor noise", "over": "Tool 60 mm above the region"}


class Remembering:
    """Answers for the last image without looking again: noise changes depth only."""

    def __init__(self) -> None:
        self._estimator, self._image, self._found = PoseEstimator(), np.zeros(0, np.uint8), None

    def estimate(self, rgb: np.ndarray) -> KeyPoints:
        if self._found is None or not np.array_equal(rgb, self._image):
            self._image, self._found = rgb.copy(), self._estimator.estimate(rgb)
        return self._found


def scene_rows(protocol: Protocol, seed: int, keypoints: Remembering) -> list[Row]:
    scene = build_scene(protocol, target="forearm")
    model, sha256 = scene.model, scene.model_sha256
    randomize_appearance(scene, seed)
    simulation = Simulation(scene)
    settle(simulation, posture_of(protocol, seed, "", 0).comfort_arm_deg, model_sha256=sha256)
    data = simulation.data
    noisy = protocol.model_copy(update={"variation": protocol.variation.model_copy(update=NOISE)})
    rows = []
    with SceneRenderer(model, protocol=protocol) as renderer:
        log = PerceptionLog(model, renderer)

        def look(rules: Protocol, condition: str, region: str, card: PolicyCard = CARD) -> None:
            builder = ObservationBuilder(renderer, card, rules, keypoints, noise=sensor_noise(rules, seed))
            seen = builder.build(data, instruction="", sim_time_s=0.0)
            log.add(data, seen)
            found = {path.partition("/")[2]: array[-1] for path, array in log.arrays().items()}
            rows.append(
                {
                    "seed": seed, "body": protocol.person.body, "tone": skin_tone(protocol, seed),
                    "condition": condition, "region": region, "somebody": somebody(seen, card.cameras[0]),
                    "sure": sure_landmarks(seen, card.cameras[0]), "error_px": found["landmark_error_px"].tolist(),
                    "visible": found["joint_visible"].tolist(), "iou": float(found["human_iou"]),
                    "target_m": found["target_error_m"].tolist(),
                }
            )  # fmt: skip

        simulation.refresh()
        joints, skin = log.joints_in_base(data), log.skin_in_base(data)
        look(protocol, "parked", "")
        look(noisy, "noise", "")
        look(protocol, "wrist", "", ON_WRIST)
        for region in STANDARD_REGIONS:
            place, _ = true_target(region, joints, skin, model.skin_face, least_share=middle_share(model, region))
            simulation.encoders.set_joint_position(data, above(place, protocol))
            mujoco.mj_forward(model, data)
            look(protocol, "over", region)
    return rows


def fingerprint(protocol: Protocol) -> str:
    """Of everything but the seed that a scene's rows depend on: rules and body, code, packages."""
    package = Path(carecontact.__file__).parent
    digest = hashlib.sha256(protocol.sha256.encode())
    for part in SOURCES:
        place = package / part
        for path in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(path.read_bytes())
    baked = package / "assets"
    for path in (baked / "bodies" / f"{protocol.person.body}.npz", baked / "panda" / "panda.npz"):
        digest.update(path.read_bytes())
    for function in (scene_rows, above, Arm, pointing_down):
        digest.update(inspect.getsource(function).encode())
    for name in PACKAGES:
        digest.update(f"{name} {metadata.version(name)}".encode())
    return digest.hexdigest()


def somebody(observation: Observation, camera: str) -> bool:
    landmarks = observation.cameras[camera].landmarks
    return landmarks is not None and bool(np.isfinite(landmarks).any())


def sure_landmarks(observation: Observation, camera: str) -> int:
    landmarks = observation.cameras[camera].landmarks
    return 0 if landmarks is None else int((landmarks[:, 2] >= SURE).sum())


def skin_tone(protocol: Protocol, seed: int) -> str:
    skin = draw_appearance(streams(protocol, seed, "")["appearance"]).skin
    return next(name for name, colour in SKIN_TONES.items() if colour == skin)


def above(place: np.ndarray, protocol: Protocol) -> np.ndarray:
    """(7,) [rad] tool down, OVER_M above a place in base; of several wrist turns the best solved, nearest to mid-range.

    Raises SystemExit if the arm cannot get there: such a scene must not be left out in silence.
    """
    arm, yaws = Arm(protocol.scene.robot), np.deg2rad(np.arange(0, 360, 30.0))
    seeds = np.tile(protocol.scene.parked_joint_rad, (len(yaws), 1))
    goal = np.tile(place + [0, 0, OVER_M], (len(yaws), 1))
    postures, error = inverse(arm, goal, pointing_down(yaws), seeds, iterations=120)
    solved = error < 2e-3
    if not solved.any():
        sys.exit(f"{protocol.person.body}: the arm cannot reach {place.round(3).tolist()} m")
    return postures[np.argmax(np.where(solved, arm.margin(postures), -np.inf))]


def tables(rows: list[Row]) -> str:
    parked = [r for r in rows if r["condition"] == "parked"]
    seeds = [r["seed"] for r in parked]
    out = [
        f"{len(parked)} scenes, {len({r['body'] for r in parked})} bodies, seeds {min(seeds)} to {max(seeds)}.",
        "",
        "| seen from overhead | " + " | ".join(CONDITIONS.values()) + " | line (parked) |",
        "|---|---|---|---|---|",
    ]

    def row(name: str, line: str, value: Callable[[list[Row]], str]) -> None:
        cells = [value([r for r in rows if r["condition"] == c]) for c in CONDITIONS]
        out.append(f"| {name} | " + " | ".join(cells) + f" | {line} |")

    row("somebody found", "", lambda rs: f"{sum(r['somebody'] for r in rs)} of {len(rs)}")
    row("landmark error, median [px]", f"<= {LANDMARK_PX:g}", lambda rs: f"{np.nanmedian(pixels(rs)):.1f}")
    row("landmark error, 95th percentile [px]", "", lambda rs: f"{np.nanpercentile(pixels(rs), 95):.1f}")
    row("human mask, mean IoU", f">= {IOU_MEAN}", lambda rs: f"{np.mean([r['iou'] for r in rs]):.3f}")
    row("human mask, least IoU", f">= {IOU_MIN}", lambda rs: f"{min(r['iou'] for r in rs):.3f}")
    for condition, title in CONDITIONS.items():
        out += ["", f"Target error [mm], {title[0].lower() + title[1:]}:", ""]
        out += [
            "| region | found | median | 95th percentile | along, median | across | up |",
            "|---|---|---|---|---|---|---|",
        ]
        for region in STANDARD_REGIONS:
            error = targets(rows, condition, region)
            found = error[np.isfinite(error).all(1)]
            if not len(found):
                found = np.full((1, 3), np.nan)
            size, parts = np.linalg.norm(found, axis=1), np.median(np.abs(found), axis=0)
            numbers = [np.median(size), np.percentile(size, 95), *parts]
            count = int(np.isfinite(error).all(1).sum())
            cells = [region.replace("_", " "), f"{count} of {len(error)}", *(f"{n:.1f}" for n in numbers)]
            out.append("| " + " | ".join(cells).replace("nan", "-") + " |")
    joints = [f"{name} {np.nanmedian(pixels(parked)[:, k]):.1f}" for k, name in enumerate(JOINTS)]
    out += ["", f"Landmark error by joint, robot parked, median [px] where visible: {', '.join(joints)}.", ""]
    missed = misses(rows)
    out.append("Missed lines: " + ("; ".join(missed) if missed else "none") + ".")
    bodies, tones = sorted({r["body"] for r in parked}), [t for t in SKIN_TONES if any(r["tone"] == t for r in parked)]
    out += ["", *grouped(rows, "body", bodies), "", *grouped(rows, "tone", tones), "", wrist(rows)]
    return "\n".join(out)


def grouped(rows: list[Row], key: str, names: list[str]) -> list[str]:
    """A table of the parked robot's scenes by body or skin tone, and a line that names the groups over a line."""
    called = {"body": "body", "tone": "skin tone"}[key]
    out = [
        f"Robot parked, by {called}, medians:",
        "",
        f"| {called} | scenes | landmarks [px] | human mask, mean IoU | forearm [mm] | upper arm | abdomen |",
        "|---|---|---|---|---|---|---|",
    ]
    over = []
    for name in names:
        mine = [r for r in rows if r["condition"] == "parked" and r[key] == name]
        medians = {region: median_mm(mine, region) for region in STANDARD_REGIONS}
        over += [f"{name} {r.replace('_', ' ')} {mm:.1f}" for r, mm in medians.items() if not mm <= TARGET_MM]
        numbers = [f"{np.nanmedian(pixels(mine)):.1f}", f"{np.mean([r['iou'] for r in mine]):.3f}"]
        out.append(
            f"| {name} | {len(mine)} | " + " | ".join([*numbers, *(f"{m:.1f}" for m in medians.values())]) + " |"
        )
    return [*out, "", f"Over {TARGET_MM:g} mm by themselves: {', '.join(over) or 'none'}."]


def median_mm(rows: list[Row], region: str) -> float:
    """Median target error of the parked robot [mm]; one that was not found counts as infinitely far."""
    error = targets(rows, "parked", region)
    return float(np.median(np.linalg.norm(np.where(np.isfinite(error), error, np.inf), axis=1)))


def wrist(rows: list[Row]) -> str:
    seen = [r for r in rows if r["condition"] == "wrist"]
    found = [r for r in seen if r["somebody"]]
    if not found:
        return f"From the wrist camera, robot parked: somebody in 0 of {len(seen)} scenes."
    far = [r for r in found if np.isfinite(pixels([r])).any()]
    error = [float(np.nanmedian(pixels([r]))) for r in far]
    off = (
        f"; joints truly in view were {min(error):.0f} to {max(error):.0f} px off (each scene's median)" if far else ""
    )
    ious = [r["iou"] for r in found]
    return (
        f"From the wrist camera, robot parked: somebody in {len(found)} of {len(seen)} scenes, with "
        f"{min(r['sure'] for r in found)} to {max(r['sure'] for r in found)} landmarks of visibility >= {SURE:g} and "
        f"human masks of IoU {min(ious):.2f} to {max(ious):.2f}{off}."
    )


def misses(rows: list[Row]) -> list[str]:
    parked = [r for r in rows if r["condition"] == "parked"]
    ious = [float(r["iou"]) for r in parked]
    measured = [
        ("landmark error", float(np.nanmedian(pixels(parked))), LANDMARK_PX, "px", 1),
        ("mean IoU", float(np.mean(ious)), IOU_MEAN, "", -1),
        ("least IoU", min(ious), IOU_MIN, "", -1),
    ]
    for region in STANDARD_REGIONS:
        error = targets(rows, "parked", region)
        size = np.linalg.norm(np.where(np.isfinite(error), error, np.inf), axis=1)
        measured.append((f"{region} target, median", median_mm(rows, region), TARGET_MM, "mm", 1))
        measured.append((f"{region} target, p95", float(np.sort(size)[int(0.95 * len(size))]), TARGET_P95_MM, "mm", 1))
    return [
        f"{name} {got:.3g} {unit} (line {line:g})"
        for name, got, line, unit, sign in measured
        if sign * got > sign * line
    ]


def pixels(rows: list[Row]) -> np.ndarray:
    """(n, joints)"""
    return np.array([r["error_px"] for r in rows], float)


def targets(rows: list[Row], condition: str, region: str) -> np.ndarray:
    """(n, 3) [mm]; with the tool above a region only that region's."""
    mine = [r for r in rows if r["condition"] == condition and r["region"] in ("", region)]
    return 1000 * np.array([r["target_m"][STANDARD_REGIONS.index(region)] for r in mine], float)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="6000-6039")
    parser.add_argument(
        "--rows",
        type=Path,
        default=Path("runs/perception.jsonl"),
        help="measured rows; kept and continued, old ones are not read again",
    )
    parser.add_argument("--docs", type=Path, help="page whose tables are replaced")
    arguments = parser.parse_args()
    first, _, last = arguments.seeds.partition("-")
    arguments.rows.parent.mkdir(parents=True, exist_ok=True)
    old = arguments.rows.read_text().splitlines() if arguments.rows.is_file() else []
    rows = [json.loads(line) for line in old]
    wanted = range(int(first), int(last or first) + 1)
    keypoints, names = Remembering(), body_names()
    kept: list[Row] = []
    for seed in wanted:
        start = time.monotonic()
        protocol = overridden(load_protocol("bathing-v3"), {"person.body": names[seed % len(names)]}).model_copy(
            update={"variation": VARIED}
        )
        mark = fingerprint(protocol)
        made = [r for r in rows if r["seed"] == seed and r.get("fingerprint") == mark]
        kept += made
        if made:
            continue
        made = [{**row, "fingerprint": mark} for row in scene_rows(protocol, seed, keypoints)]
        kept += made
        with arguments.rows.open("a") as file:
            file.writelines(json.dumps(row) + "\n" for row in made)
        print(f"seed {seed} {protocol.person.body} {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
    text = tables(kept)
    print(text)
    if arguments.docs:
        page = arguments.docs.read_text()
        before, after = page.partition(BEGIN)[0], page.partition(END)[2]
        arguments.docs.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}")


if __name__ == "__main__":
    main()
