"""Changes since the scan as objects (see `panoloc.core.changes`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ObjectChangesConfig:
    """Comparing photos with the scan, and telling what came and went. Chosen on development seeds of `python -m tests.campaign changes`."""

    rows: int = 256  # of the spheres that photos are compared on: 0.7 degrees a pixel, 4 cm at 3 m
    dark: float = 0.04  # added to colours of 0..1 before logarithms are taken, so that noise in shadows weighs little
    hue_weight: float = 2.5  # shadows change brightness, hardly hue
    half: float = 0.22  # distance of logarithms from which on a pixel is rather changed than not
    light_deg: float = 25.0  # width of the surroundings on which light is fitted (standard deviation)
    light_steps: int = 4
    voxel_m: float = 0.1
    near_m: float = 0.25  # from the camera: its tripod, its operator's hand
    surface_m: float = 0.1  # a voxel within it of the scan's surface lies at it
    tile: int = 64  # voxels across of what the network sees at once; and around it, of which it sees the half only
    margin: int = 16
    reach_m: float = 8.0  # from a camera, beyond which objects of 0.3 m are a few pixels
    most_photos: int = 8  # that have their say on a tile
    least_changed: float = 0.3  # of what all photos agree on, somewhere in a tile; else nothing in it changed
    likely: float = 0.25  # that a middle is near a cell, from which on there is an object
    likely_voxel: float = 0.4  # of a voxel, from which on it belongs to an object
    # Of two objects that did the same: how far apart they are at least, and how much of the smaller one's box they share at most.
    least_apart_m: float = 0.3
    most_shared: float = 0.6
    # What went and came moved where the mean logarithms of its sides, and its colours, differ less than these.
    size_apart: float = 0.35
    color_apart: float = 0.2
    least_side_m: float = 0.3  # the largest of an object; smaller ones are rather noise
    # Of an object's voxels that a photo shows, and how changed they look on average, for it to have seen the change.
    seen_share: float = 0.1
    seen_changed: float = 0.15
    # Log odds that what is found did change: a constant, and a weight of the network's log odds. Logistic regression on development seeds.
    certainty: tuple[float, float] = (0.7, 2.6)
    most_likely: float = 0.8  # beyond which no difference was measured
    sure: float = 0.3  # certainty from which on a change is stated; below, it is unsure (docs/evaluation.md)


CHANGES = ObjectChangesConfig()
