"""Find a mistake in a recording before it costs a day: commands written in millimetres."""

from pathlib import Path

import calib
import rig
import synthetic

Path("rig.toml").write_text(rig.new_rig_toml(rig.LayoutOptions(radius=0.3, cameras=2, cubes=2)))
synthetic.simulate("rig.toml", synthetic.SimulateOptions(plan="sobol:6", seed=1)).write("REC")
print(calib.check("REC"))

table = Path("REC/commands.csv")
header, *rows = table.read_text().splitlines()
for i, row in enumerate(rows):
    t, *lengths = row.split(",")
    rows[i] = ",".join([t, *(f"{1e3 * float(length):.6f}" for length in lengths)])
table.write_text("\n".join([header, *rows]) + "\n")

for line in calib.check("REC").lines()[:1]:
    print(line)
