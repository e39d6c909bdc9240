"""Reads what `vergence log export` wrote, and the logs themselves, and compares the numbers."""

import math
import sys
from pathlib import Path

import pandas
import pyarrow.parquet
from mcap_protobuf.reader import read_protobuf_messages

folder, broad = Path(sys.argv[1]), Path(sys.argv[2])


def same(a, b):
    return a == b or (isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b))


def frames(log, stream):
    """The stream's table, out of CSV and out of Parquet."""
    csv = pandas.read_csv(folder / f"{log}.csv" / f"{stream}.csv", float_precision="round_trip")
    parquet = pyarrow.parquet.read_table(folder / f"{log}.parquet" / f"{stream}.parquet").to_pandas()
    assert list(csv.columns) == list(parquet.columns), (csv.columns, parquet.columns)
    assert len(csv) == len(parquet)
    for column in csv.columns:
        for a, b in zip(csv[column].tolist(), parquet[column].tolist()):
            assert same(a, b) or (b is None and (a != a)), (log, stream, column, a, b)
    return csv


table = frames("csv", "table")
assert table["captured_ns"].tolist() == [-5, 7, 9]
assert same(table["x"].tolist()[1], math.nan) and table["y z"].tolist() == [0.1, 1e300, 3.0]

imu = frames("broad", "imu")
original = pandas.read_csv(broad, float_precision="round_trip")
assert len(imu) == len(original)
for ours, theirs in [("gyr_rad_s.x", "gyr_x"), ("acc_m_s2.z", "acc_z"), ("mag_ut.y", "mag_y")]:
    assert imu[ours].tolist() == original[theirs].tolist(), ours

truth = frames("broad", "truth")
assert len(truth) == len(original) and original["gt_px"].notna().sum() > original["gt_qw"].notna().sum() > 50000
for axis in "xyz":
    pairs = zip(truth[f"pose.position.{axis}"].tolist(), original[f"gt_p{axis}"].tolist())
    assert all(same(ours, theirs) for ours, theirs in pairs), axis
for axis in "xyzw":
    pairs = zip(truth[f"pose.orientation.{axis}"].tolist(), original[f"gt_q{axis}"].tolist())
    assert all(same(ours, theirs) for ours, theirs in pairs), axis

markers = frames("xdf", "MyMarkerStream")
samples = frames("xdf", "BioSemi")
assert (len(markers), len(samples)) == (175, 27815)

values = samples.iloc[:, 2:].to_numpy().tolist()
times = samples["captured_ns"].tolist()
count = 0
for message in read_protobuf_messages(str(folder / "xdf.mcap"), topics=["/BioSemi"]):
    row = message.proto_msg
    assert row.captured_ns == times[count]
    assert list(row.numbers) == values[count], count
    count += 1
assert count == len(samples)
print(f"equal: {len(table)} + {len(imu)} + {len(markers)} + {len(samples)} rows")
