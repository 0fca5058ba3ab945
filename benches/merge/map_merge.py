"""multirobot_map_merge's estimation on the pairs of maps of the merging bench, at each confidence threshold.

usage: map_merge.py PAIRS [--json FILE]

It calls the functions of OpenCV that multirobot_map_merge 712bdd4 calls, in the same order, with the same settings:
AKAZE features, AffineBestOf2NearestMatcher, AffineBasedEstimator, BundleAdjusterAffinePartial. None of that package's code
is needed. PAIRS is the folder that `cargo bench --bench merge` reads. The errors are computed as there.
Needs numpy, PyYAML, Pillow and opencv-python-headless 4.
"""

import argparse
import json
import math
import pathlib

import cv2
import numpy as np
import yaml
from PIL import Image

DEFAULT_CONFIDENCE = 1.0
# Value of params.yaml in its ROS 2 port, and the one that its users are told to try.
OTHER_CONFIDENCES = (0.6, 0.3)
# A place is right below these, as in benches/merge/pairs.rs: RMS displacement of b's walls, and rotation.
RIGHT_M, RIGHT_DEG = 0.5, 5.0
UNKNOWN, OCCUPIED = 255, 100
# A transform whose determinant is smaller cannot be inverted: its estimate failed.
SINGULAR = 1e-9


class Map:
    """An occupancy grid as the package sees it: 0, 100 or 255 (-1) a cell, row 0 at the smallest y."""

    def __init__(self, path):
        about = yaml.safe_load(path.read_text())
        pixels = np.asarray(Image.open(path.parent / about["image"]).convert("L"), dtype=float)
        occupied = (pixels if about.get("negate") else 255.0 - pixels) / 255.0
        cells = np.full(pixels.shape, UNKNOWN, np.uint8)
        cells[occupied < about["free_thresh"]] = 0
        cells[occupied > about["occupied_thresh"]] = OCCUPIED
        self.cells = np.ascontiguousarray(cells[::-1])
        self.resolution_m = about["resolution"]
        x, y, yaw = about["origin"]
        cos, sin = math.cos(yaw) * self.resolution_m, math.sin(yaw) * self.resolution_m
        # Takes the centre of a pixel (column, row) to metres.
        self.metres_from_pixel = np.array([[cos, -sin, x], [sin, cos, y], [0, 0, 1.0]]) @ np.array(
            [[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])


def estimate(a, b):
    """Returns the confidence and the transform in pixels from b to a, or None without one."""
    finder = cv2.AKAZE_create()
    features = [cv2.detail.computeImageFeatures2(finder, grid.cells) for grid in (a, b)]
    if min(len(feature.getKeypoints()) for feature in features) == 0:
        return 0.0, None
    matches = cv2.detail_AffineBestOf2NearestMatcher().apply2(features)
    confidence = max(float(match.confidence) for match in matches)
    found, cameras = cv2.detail_AffineBasedEstimator().apply(features, matches, None)
    if not found or confidence <= 0.0:
        return confidence, None
    for camera in cameras:
        camera.R = camera.R.astype(np.float32)
    adjuster = cv2.detail_BundleAdjusterAffinePartial()
    adjuster.setConfThresh(0.0)
    found, cameras = adjuster.apply(features, matches, cameras)
    if not found:
        return confidence, None
    # The package draws each map with the inverse of its transform.
    a_from_reference, b_from_reference = (camera.R.astype(float) for camera in cameras)
    if abs(np.linalg.det(b_from_reference)) < SINGULAR:
        return confidence, None
    return confidence, a_from_reference @ np.linalg.inv(b_from_reference)


def errors(a, b, a_from_b_pixels, truth):
    """Returns the RMS displacement of b's walls where a is known, m, and the rotation's error, degrees."""
    rows, columns = np.nonzero(b.cells == OCCUPIED)
    pixels = np.stack([columns, rows, np.ones_like(rows)]).astype(float)
    at = b.metres_from_pixel @ pixels
    x, y, yaw = truth
    true_transform = np.array([[math.cos(yaw), -math.sin(yaw), x], [math.sin(yaw), math.cos(yaw), y], [0, 0, 1.0]])
    truly = true_transform @ at
    in_a = np.rint(np.linalg.inv(a.metres_from_pixel) @ truly).astype(int)
    height, width = a.cells.shape
    inside = (in_a[0] >= 0) & (in_a[0] < width) & (in_a[1] >= 0) & (in_a[1] < height)
    known = inside.copy()
    known[inside] = a.cells[in_a[1][inside], in_a[0][inside]] != UNKNOWN
    if not known.any():
        return math.inf, 180.0
    placed = a.metres_from_pixel @ a_from_b_pixels @ pixels
    displacement = np.hypot(*(placed - truly)[:2])[known]
    transform = a.metres_from_pixel @ a_from_b_pixels @ np.linalg.inv(b.metres_from_pixel)
    turned = math.atan2(transform[1, 0], transform[0, 0]) - yaw
    turned = math.degrees(abs((turned + math.pi) % (2 * math.pi) - math.pi))
    return float(np.sqrt(np.mean(displacement ** 2))), turned


def judge(folder):
    """Returns what the package would say of a pair."""
    truth = json.loads((folder / "truth.json").read_text())
    a, b = Map(folder / "a.yaml"), Map(folder / "b.yaml")
    confidence, transform = estimate(a, b)
    outcome = {"pair": folder.name, "confidence": confidence if transform is not None else 0.0,
               "overlap": truth.get("ov_min") or 0.0, "negative": truth.get("T_A_B") is None, "right": False}
    if transform is not None and not outcome["negative"]:
        outcome["error_m"], outcome["error_deg"] = errors(a, b, transform, truth["T_A_B"])
        outcome["right"] = outcome["error_m"] < RIGHT_M and outcome["error_deg"] < RIGHT_DEG
    return outcome


def count(outcomes, confidence):
    """Returns (right, wrong, negatives accepted, median error) at a threshold."""
    accepted = [outcome for outcome in outcomes if outcome["confidence"] >= confidence]
    right = [outcome for outcome in accepted if outcome["right"]]
    negatives = sum(outcome["negative"] for outcome in accepted)
    median = float(np.median([outcome["error_m"] for outcome in right])) if right else math.nan
    return len(right), len(accepted) - len(right) - negatives, negatives, median


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("pairs", type=pathlib.Path)
    arguments.add_argument("--json", type=pathlib.Path)
    given = arguments.parse_args()
    folders = sorted(path.parent for path in given.pairs.glob("*/truth.json"))
    if not folders:
        raise SystemExit(f"{given.pairs}: no folder with truth.json")
    outcomes = []
    for index, folder in enumerate(folders, 1):
        print(f"\r{index} of {len(folders)}", end="", flush=True)
        outcomes.append(judge(folder))
    positives = sum(not outcome["negative"] for outcome in outcomes)
    print(f"\r{positives} pairs with overlap, {len(outcomes) - positives} negatives (different buildings)")
    # The best threshold is the one with most pairs right among those that accept nothing wrong.
    thresholds = sorted({outcome["confidence"] for outcome in outcomes if outcome["confidence"] > 0})
    clean = [level for level in thresholds if count(outcomes, level)[1:3] == (0, 0)]
    best = min(clean, default=math.inf)
    rows = [("default", DEFAULT_CONFIDENCE), *(("", level) for level in OTHER_CONFIDENCES), ("best", best)]
    print(f"{'confidence >=':<22}{'right':>8}{'wrong':>8}{'negatives':>11}{'median error, m':>18}")
    for name, level in rows:
        right, wrong, negatives, median = count(outcomes, level)
        print(f"{f'{level:.3f} {name}':<22}{right:>8}{wrong:>8}{negatives:>11}{median:>18.3f}")
    if given.json:
        given.json.write_text(json.dumps(outcomes, indent=1))


main()
