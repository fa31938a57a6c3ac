"""Gaussian splats as 3D Gaussian Splatting's own code writes them."""

import numpy as np
from numpy.typing import NDArray

from panoloc.core.scan.point_cloud import PointCloud


def splat_ply(cloud: PointCloud, opacities: NDArray[np.float64]) -> bytes:
    """Return a splat of 1 cm at every point of `cloud`, opacities (N,) 0..1, with harmonics of degree 1 that see nothing."""
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{n}" for n in range(9))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    table = np.zeros((len(cloud), len(names)), "<f4")
    table[:, :3] = cloud.positions
    table[:, 6:9] = (cloud.colors / 255 - 0.5) * 2 * np.sqrt(np.pi)
    table[:, 18] = np.log(opacities / (1 - opacities))
    table[:, 19:22] = np.log(0.01)
    table[:, 22] = 1
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(cloud)}"]
    header += [f"property float {name}" for name in names]
    return ("\n".join([*header, "end_header"]) + "\n").encode() + table.tobytes()
