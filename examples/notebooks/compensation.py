# %% [markdown]
# # Compensated motion
#
# The friction that the estimator knows, fed forward. A simulated axis follows a circle, sample by
# sample, with the emitted C in its loop. The plant's friction is 30 % off the machine file's and
# drifts by another 25 %; its elements switch at once.

# %%
import matplotlib.pyplot as plt
import numpy as np

import sgms_mhe
from sgms_bench.compensation.running import compare_compensations

machine = sgms_mhe.load("etel_xy_compensation")
compared = compare_compensations(machine, ["circle"], duration_s=6.0)
print(compared.table)

# %% [markdown]
# ## Error after a reversal
#
# Where an axis turns round friction changes sign, and an axis without compensation is left behind.

# %%
figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
for method in ("none", "static", "MHE"):
    run, _ = compared.runs["circle", method]
    time_s = np.arange(len(run.error_m)) / machine.sampling.rate
    axes.plot(time_s, 1e9 * run.error_m, linewidth=0.8, label=method)
axes.set(xlabel="time [s]", ylabel="error of x [nm]")
axes.legend(loc="upper right")
plt.show()

# %% [markdown]
# ## What it costs to be wrong
#
# Mean of the largest errors after each reversal, against the same without compensation.

# %%
for row in ("circle, x", "circle, y", "circle, contour"):
    peak_m = {method: compared.measures[row, method].peak_m for method in ("none", "static", "MHE", "true friction")}
    shares = [f"{method} {peak / peak_m['none']:.1%}" for method, peak in peak_m.items() if method != "none"]
    print(f"{row}: {', '.join(shares)} of {1e9 * peak_m['none']:.0f} nm")

# %% [markdown]
# ## Turning it on in a machine file
#
# Four keys of `[compensation]`: the loop's delay, a ramp, a limit, and the speed below which the force
# holds ([why](../../docs/compensation.md#standstill)).

# %%
print(machine.compensation)
