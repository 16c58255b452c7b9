# %% [markdown]
# # An effect of one's own
#
# Preload magnets pull the carriage towards the middle of its stroke. The catalogue has no such
# effect, so a distribution of its own brings it: `examples/magnetic_preload/`, two files.
#
# ```
# pip install ./examples/magnetic_preload
# ```
#
# Its module holds an `EffectDefinition`: parameters, the symbolic force, what a record must hold, its
# rivals, how its fit starts. Every command then knows it
# ([what to write](../../CONTRIBUTING.md#an-effect-of-your-own-outside-this-package)).

# %%
import inspect
from pathlib import Path

import magnetic_preload
import matplotlib.pyplot as plt
import numpy as np

import sgms_mhe

print(inspect.getsource(magnetic_preload.DEFINITION.contribute))

# %% [markdown]
# ## In a machine file
#
# By its name, as any other. Here it is the truth of a simulated axis.

# %%
PLAIN = """
name = "preloaded"
description = "two elements, 1 kHz"

[plant]
mass = 20.0

[friction]
stiffness = [3e4, 1e4]
fraction = [0.25, 0.75]
viscous = 20.0
coulomb = 4.0

[sampling]
rate = 1000.0
update_rate = 50.0
velocity_cutoff = 100.0

[estimator]
horizon = 5
parameters = ["stiffness", "coulomb"]
"""
EFFECT = """
[[effects]]
name = "magnetic_preload"
force_N = 1.5
reach_m = 0.001
centre_m = 0.001
"""
Path("plain.toml").write_text(PLAIN, encoding="utf-8")
Path("true.toml").write_text(PLAIN + EFFECT, encoding="utf-8")
log = sgms_mhe.simulate("true.toml", "paper", seed=1).log

# %% [markdown]
# ## Found in a log
#
# The diagnosis of a machine file that knows nothing of magnets searches the installed effect beside
# those of the catalogue.

# %%
found = sgms_mhe.diagnose("plain.toml", log)
print(f"{found.verdict}: {found.summary}")
for cause in found.causes:
    numbers = [f"{name} = {value:.4g} +- {2.0 * cause.std[name]:.1g}" for name, value in cause.parameters.items()]
    print(f"{cause.name}: {', '.join(numbers)}")

# %% [markdown]
# ## The force over position

# %%
position_m = np.linspace(log.position_m.min(), log.position_m.max(), 500)
figure, axes = plt.subplots(figsize=(8, 3), layout="constrained")
for cause in found.causes:
    p = cause.parameters
    axes.plot(1e3 * position_m, p["force_N"] * np.tanh((position_m - p["centre_m"]) / p["reach_m"]))
axes.set(xlabel="position [mm]", ylabel="pull that was found [N]")
plt.show()

# %% [markdown]
# ## In C
#
# The package of the extended machine has the force in its model.

# %%
if found.extended is not None:
    package = sgms_mhe.generate(found.extended, "package")
    named = [line for line in package.files["structure.txt"].splitlines() if "magnetic_preload" in line]
    print("\n".join(named))
