"""What evo says of two trajectories, as one JSON object a line: by_evo.py ESTIMATE TRUTH ALIGN FRAMES..."""

import copy
import json
import sys

from evo.core import metrics, sync
from evo.main_ape import ape
from evo.main_rpe import rpe
from evo.tools import file_interface

estimate, truth, align, *spans = sys.argv[1:]
estimate = file_interface.read_tum_trajectory_file(estimate)
truth = file_interface.read_tum_trajectory_file(truth)
truth, estimate = sync.associate_trajectories(truth, estimate, max_diff=0.01)
how = {"align": align != "none", "correct_scale": align == "sim3"}

result = ape(copy.deepcopy(truth), copy.deepcopy(estimate), metrics.PoseRelation.translation_part, **how)
out = {"ate_rmse_m": result.stats["rmse"], "ate_max_m": result.stats["max"], "matched": truth.num_poses}
_, _, out["scale"] = copy.deepcopy(estimate).align(truth, correct_scale=True)
for name, frames in zip(["rpe_1s", "rpe_5s"], spans):
    for unit, relation in [("m", metrics.PoseRelation.translation_part), ("rad", metrics.PoseRelation.rotation_angle_rad)]:
        result = rpe(copy.deepcopy(truth), copy.deepcopy(estimate), relation, delta=int(frames),
                     delta_unit=metrics.Unit.frames, all_pairs=True, **how)
        out[f"{name}_{unit}"] = result.stats["rmse"]
print(json.dumps(out))
