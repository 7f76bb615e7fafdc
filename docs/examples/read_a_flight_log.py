"""The positions of a receiver in a flight log (`acquire record`, `acquire import`) as arrays."""

import numpy as np

import photocal

log = photocal.read_log("flight.mcap")
for topic, columns in log.items():
    print(topic, len(columns["log_ns"]), "messages of", ", ".join(columns))

fix = photocal.read_log("flight.mcap", ["/gnss/rover/fix"])["/gnss/rover/fix"]
seconds = (fix["publish_ns"] - fix["publish_ns"][0]) / 1e9
print(
    "rate",
    round(1 / np.median(np.diff(seconds)), 2),
    "Hz; heights",
    fix["altitude"].min(),
    fix["altitude"].max(),
)
