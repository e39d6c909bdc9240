"""Throughput of a study from its exported trials, computed as the methods text says and with nothing of Vergence."""
import csv
import json
import math
import statistics
import sys

sequences = {}
for row in csv.DictReader(open(sys.argv[1], newline="")):
    if "1" in (row["practice"], row["repeated"], row["outlier"]):
        continue
    key = (row["participant"], row["session"], row["block"], row["condition"])
    sequences.setdefault(key, []).append(row)


def place(row, name):
    return [float(row[f"{name}_{axis}"]) for axis in "xyz"]


throughputs = []
for rows in sequences.values():
    along, amplitudes = [], []
    for row in rows:
        origin, target, start, end = (place(row, name) for name in ("from", "to", "start", "end"))
        length = math.dist(origin, target)
        unit = [(b - a) / length for a, b in zip(origin, target)]
        along.append(sum((e - t) * u for e, t, u in zip(end, target, unit)))
        amplitudes.append(sum((e - s) * u for e, s, u in zip(end, start, unit)))
    time = statistics.fmean(float(row["mt_s"]) for row in rows)
    width = math.sqrt(2 * math.pi * math.e) * statistics.stdev(along)
    throughputs.append(math.log2(statistics.fmean(amplitudes) / width + 1) / time)
print(json.dumps({"sequences": len(throughputs), "tp": statistics.fmean(throughputs)}))
