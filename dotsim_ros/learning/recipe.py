# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How each kind of network is trained. Importing it does not load torch."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TrainingRecipe:
    """How a network is trained on the mean square error of its image.

    Attributes:
        learning_rate: of Adam, the highest where it changes.
        weight_decay: added to the gradient, or, where decoupled, to the step (AdamW).
        batch: frames a step.
        epochs: passes over all frames.
        one_cycle: the learning rate rises over the first tenth and falls to zero along a cosine
            (Smith, "A disciplined approach to neural network hyper-parameters", 2018).
        decoupled: AdamW in place of Adam.
        averaging: share of the running mean of the weights that stays in each step; 0 for none.
    """

    learning_rate: float = 3e-4
    weight_decay: float = 1e-4
    batch: int = 8
    epochs: int = 100
    one_cycle: bool = False
    decoupled: bool = False
    averaging: float = 0.0


PUBLISHED = TrainingRecipe()
RECIPES: dict[str, TrainingRecipe] = {
    "ours": TrainingRecipe(
        learning_rate=4e-3,
        weight_decay=1e-2,
        batch=4,
        epochs=16,
        one_cycle=True,
        decoupled=True,
        averaging=0.98,
    ),
    **dict.fromkeys(
        ("paper", "paper_direct", "paper_mobile", "paper_mobile_warped", "unet"), PUBLISHED
    ),
}


def check_epochs(epochs: int | None, name: str = "epochs") -> None:
    """Refuse a number of epochs.

    Args:
        epochs: passes over all frames; None for the recipe's number.
        name: what the user calls it.

    Raises:
        ValueError: it is below one.
    """
    if epochs is not None and epochs < 1:
        raise ValueError(
            f"{name} is {epochs}, expected 1 or more; leave it out for a training of full length"
        )
