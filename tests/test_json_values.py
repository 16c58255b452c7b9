"""Numbers in JSON: plain, and null where they are not finite."""

import json
import math

import numpy as np
import pytest

from sgms_mhe.support.json_values import finite

pytestmark = pytest.mark.core


def test_what_is_not_finite_is_null_and_the_rest_stays() -> None:
    content = {
        "numbers": (1.5, math.nan, -math.inf, np.float64(0.25), np.float32(0.5), np.float32("nan")),
        "others": [True, 3, "text", None, {"deep": math.inf}],
    }
    expected = {"numbers": [1.5, None, None, 0.25, 0.5, None], "others": [True, 3, "text", None, {"deep": None}]}
    assert json.loads(json.dumps(finite(content), allow_nan=False)) == expected
    assert finite(content)["others"][0] is True
    assert all(type(value) is float for value in finite(content)["numbers"] if value is not None)
