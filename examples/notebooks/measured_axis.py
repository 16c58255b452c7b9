# %% [markdown]
# # A measured axis: EMPS
#
# The public benchmark of an electro-mechanical positioning system: what one half of the record
# teaches has to hold on the other. The record, `DATA_EMPS.mat`, is not part of this repository
# ([who measured it](../../docs/measured_axis.md)); its path is in `EMPS_RECORD`.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

import sgms_mhe
from sgms_mhe.machine import Machine

RECORD = os.environ.get("EMPS_RECORD", "DATA_EMPS.mat")
HALF_s = 12.42  # two of the four laps

# %% [markdown]
# ## The record, as it is
#
# The machine file's `[log]` table names the variables of the MAT file and the drive's gain; nothing is
# converted by hand.

# %%
machine = sgms_mhe.load("emps")
log = sgms_mhe.read_log(RECORD, machine)
print(f"{len(log.time_s)} samples at {log.rate:g} Hz")
figure, (above, below) = plt.subplots(2, 1, figsize=(8, 4), sharex=True, layout="constrained")
above.plot(log.time_s, 1e3 * log.position_m)
above.set(ylabel="position [mm]")
below.plot(log.time_s, log.force_N, linewidth=0.8)
below.set(xlabel="time [s]", ylabel="force [N]")
plt.show()

# %% [markdown]
# ## What an estimator makes of it
#
# The emitted C, compiled here and run over the whole record.

# %%
estimates = sgms_mhe.estimate(machine, log).to_frame()
error = estimates["friction_measured_N"] - estimates["friction_N"]
print(f"measured minus estimated friction: {np.sqrt((error**2).mean()):.2f} N RMS")
print(estimates[["coulomb", "std_coulomb", "viscous", "std_viscous"]].iloc[-1].to_string())

# %% [markdown]
# ## What the model gets wrong
#
# Diagnosed on the first half. `unexplained` names what is certain, and says that more is left.

# %%
frame = log.to_frame()
found = sgms_mhe.diagnose(machine, frame[frame["time_s"] < HALF_s])
print(f"{found.verdict}: {found.summary}")
for cause in found.causes:
    print(f"  {cause.name}: " + ", ".join(f"{name} = {value:.4g}" for name, value in cause.parameters.items()))

# %% [markdown]
# ## On the half that it has not seen


# %%
def left(axis: Machine) -> float:
    """RMS of measured minus predicted friction on the second half [N]."""
    predicted = sgms_mhe.predict(axis, log).to_frame()
    residual = predicted["friction_measured_N"] - predicted["friction_N"]
    return float(np.sqrt((residual[predicted["time_s"] >= HALF_s] ** 2).mean()))


print(f"published model: {left(machine):.2f} N RMS")
if found.extended is not None:
    print(f"with its causes: {left(found.extended):.2f} N RMS")
