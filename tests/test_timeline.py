"""The picture of a log over time."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from jaxcap import Case
from jaxcap.plotting import timeline


def scores(n=12):
    return {
        "t": np.r_[np.arange(n // 2), np.arange(n // 2)] * 0.1,
        "episode": np.repeat(["a", "b"], n // 2),
        "margin": np.r_[np.nan, np.linspace(-1, 1, n - 2), np.inf],
        "case": np.array([Case.C1, Case.C3_1] * (n // 2), dtype=np.int8),
        "contact_mask": np.stack([np.arange(n) < 4, np.arange(n) < 8, np.arange(n) > 2], axis=1),
    }


def test_margin_case_and_contacts_are_what_was_computed():
    given = scores()
    margin, case, contacts = timeline(given, {"left": 2, "right": 1})
    line = margin.get_lines()[1]
    np.testing.assert_allclose(line.get_xdata(), np.arange(12) * 0.1)
    np.testing.assert_array_equal(line.get_ydata()[1:-1], given["margin"][1:-1])
    assert np.isnan(line.get_ydata()[[0, -1]]).all()
    assert [label.split(":")[0] for label in case.get_legend_handles_labels()[1]] == ["C1", "C3_1"]
    bands = np.asarray(case.collections[0].get_array()).ravel()
    assert (bands == (given["case"] == Case.C3_1)).all()
    drawn = np.asarray(contacts.collections[0].get_array()).reshape(2, 12)
    assert (drawn[0] == given["contact_mask"][:, :2].sum(axis=1)).all()
    assert (drawn[1] == 2 * given["contact_mask"][:, 2]).all()
    assert [text.get_text() for text in contacts.get_yticklabels()] == ["left", "right"]
    assert "[m/s]" in margin.get_ylabel() and "[s]" in contacts.get_xlabel()
    margin.figure.canvas.draw()


def test_episodes_are_marked_and_follow_each_other():
    marks = [line for line in timeline(scores())[0].get_lines() if line.get_gid() == "episode"]
    assert [line.get_xdata()[0] for line in marks] == pytest.approx([0.55])


def test_axes_that_are_given_are_drawn_into():
    axes = tuple(Figure().subplots(3))
    assert timeline({"margin": np.zeros(1), "case": np.zeros(1, np.int8)}, axes=axes) == axes
    assert axes[2].get_xlabel() == "row"


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(ValueError, match="expected 'margin' and 'case'"):
        timeline({"margin": np.zeros(3)})
    with pytest.raises(ValueError, match=r"patches have 2 contacts \(expected 3"):
        timeline(scores(), {"left": 2})
