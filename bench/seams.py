"""Whether the borders of clusters show: jumps across edges, at borders and inside clusters.

python bench/seams.py [--write]
"""

from __future__ import annotations

import numpy as np
from tables import HUMAN, ROBOT, dataset, publish

from prtnet.seams import JumpSum, cluster_of_receiver, receiver_edges
from training.config import PRESETS
from training.train import train


def main() -> None:
    """The default model of both characters, on their held-out clips."""
    table = []
    for name, scene, config in (("robot", "robot.glb", ROBOT), ("human", "human.glb", HUMAN)):
        data = dataset(name, scene, config)
        model = train(data, PRESETS["default"])
        edges = receiver_edges(data.faces, data.receiver_of_vertex)
        owner = cluster_of_receiver(model.receivers)
        errors, truths = JumpSum(edges), JumpSum(edges)
        rows = data.held_out_poses()
        level = 0.0
        for start in range(0, len(rows), 8):
            block = rows[start : start + 8]
            truth = data.read("visibility", block)
            errors.add(model(data.read("pose", block)) - truth)
            truths.add(truth)
            level += float(np.square(truth, dtype=np.float64).sum())
        root = (level / len(rows) / len(data.rest_positions)) ** 0.5
        ratio = errors.rms(owner)[0] / errors.rms(owner)[1]
        parts = (*errors.rms(owner), *truths.rms(owner))
        borders = (owner[edges[:, 0]] != owner[edges[:, 1]]).mean()
        table.append(
            [name, f"{100 * borders:.0f} %", *(f"{100 * p / root:.2f} %" for p in parts),
             f"{ratio:.2f}"]
        )  # fmt: skip
        print(table[-1], flush=True)
    publish(
        "seams",
        (
            "held-out clips", "edges at borders", "error's jump there", "inside clusters",
            "truth's jump there", "truth's inside", "seam ratio",
        ),
        table,
        "Jumps across edges of the mesh, RMS, relative to the RMS of visibility.",
    )  # fmt: skip


if __name__ == "__main__":
    main()
