# %% [markdown]
# # From a trace to C that knows the axis
#
# An axis whose machine file misses something: the trace says what, and the package has it.

# %%
from pathlib import Path

import matplotlib.pyplot as plt

import sgms_mhe

# %% [markdown]
# ## The machine file
#
# What is believed of the axis ([how one is written](../../docs/own_axis.md#1-the-machine-file)).

# %%
AXIS = """
name = "own_axis"
description = "two elements, 5 kHz"

[plant]
mass = 20.0

[friction]
stiffness = [3e4, 1e4]
fraction = [0.25, 0.75]
viscous = 20.0
coulomb = 4.0

[sampling]
rate = 5000.0
update_rate = 50.0
velocity_cutoff = 200.0

[estimator]
horizon = 5
parameters = ["stiffness", "coulomb"]
"""
Path("own_axis.toml").write_text(AXIS, encoding="utf-8")
machine = sgms_mhe.load("own_axis.toml")

# %% [markdown]
# ## The trace
#
# Simulated here, with a ripple that the machine file does not know. A trace of your own takes its
# place: any text, MAT, HDF5, Parquet or MDF file with time, position and force.

# %%
RIPPLE = ("force_ripple", {"amplitude_N": 1.5, "pitch_m": 0.02, "phase_rad": 0.6})
run = sgms_mhe.simulate(machine, "mixed", duration_s=8.0, hidden_effects=[RIPPLE], seed=1)
run.log.to_frame().to_csv("trace.csv", index=False)

log = sgms_mhe.read_log("trace.csv")
print(f"{len(log.time_s)} samples at {log.rate:g} Hz")

# %% [markdown]
# ## What the model gets wrong
#
# The diagnosis names causes only where the record allows it, and measures what naming them gains on
# data that the fit has not seen.

# %%
found = sgms_mhe.diagnose(machine, log)
print(f"{found.verdict}: {found.summary}")
for cause in found.causes:
    numbers = [f"{name} = {value:.4g} +- {2.0 * cause.std[name]:.1g}" for name, value in cause.parameters.items()]
    print(f"{cause.name}: {', '.join(numbers)}")

# %% [markdown]
# ## Before and after
#
# Measured friction minus the model's, along the trace.

# %%
extended = found.extended or machine  # where nothing is named the machine file is right as it is
figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
for name, axis in (("as believed", machine), ("with the cause", extended)):
    predicted = sgms_mhe.predict(axis, log).to_frame()
    residual = predicted["friction_measured_N"] - predicted["friction_N"]
    axes.plot(predicted["time_s"], residual, linewidth=0.8, label=name)
    print(f"{name}: {(residual**2).mean() ** 0.5:.3f} N RMS")
axes.set(xlabel="time [s]", ylabel="friction not explained [N]")
axes.legend(loc="upper right")
plt.show()

# %% [markdown]
# ## The package
#
# C99 without a library, ready for a controller; its README has the ten lines that call it.

# %%
if found.extended is not None:
    Path("extended.toml").write_text(found.extended_file(), encoding="utf-8")
package = sgms_mhe.generate(extended, "package")
print(f"{len(package.files)} files in package/")
