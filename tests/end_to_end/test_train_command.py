"""softdeca train: a corpus, a network and its test, by one command; small enough here to learn nothing."""

import json
from dataclasses import replace

import pytest

from softdeca.benchmarks import learned
from softdeca.surrogate import Surrogate
from softdeca.surrogate.checkpoint import HypernetworkConfig
from softdeca.surrogate.train import TrainConfig


def test_what_is_simulated_is_learned_from_and_tested_on(command, monkeypatch, tmp_path):
    monkeypatch.setattr(learned, "default_path", lambda: tmp_path / "surrogate.npz")
    monkeypatch.setattr(learned, "PLAN", replace(learned.PLAN, identities=4, groups=1, frames=2, random=4, seconds=4.0))
    small = HypernetworkConfig(latent=4, expression_hidden=8, position=4, gain_hidden=4, hidden=4)
    monkeypatch.setattr(learned, "TRAINING", TrainConfig(network=small, steps=4, validate_every=2))
    ended = command("train", "--out", tmp_path / "out", "--json")
    figures = json.loads(ended.out)
    assert figures["training_frames"] > 0 and figures["test"]["frames"] > 0
    assert figures["corpus"]["accepted"] + len(figures["corpus"]["rejected"]) == 8
    assert ended.status == (0 if figures["test"]["gain"] > 1.0 else 1)
    assert Surrogate.load(tmp_path / "surrogate.npz").checkpoint.parameter_names == (
        "soft_stiffness",
        "target_stiffness",
        "gravity",
    )
    again = command("train", "--out", tmp_path / "out", "--json")
    assert json.loads(again.out)["test"]["gain"] == pytest.approx(figures["test"]["gain"])
