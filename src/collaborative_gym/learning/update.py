"""What an update tells of a learner."""

UPDATE = {
    "kl": ("KL", ".4f"),
    "learning_rate": ("learning rate", ".1e"),
    "std": ("std", ".3f"),
    "policy_loss": ("policy loss", ".4f"),
    "value_loss": ("value loss", ".4f"),
    "entropy_loss": ("entropy loss", ".4f"),
    "entropy_weight": ("entropy weight", ".4f"),
    "weight_norm": ("weight norm", ".1f"),
}
"""What each number is called on the terminal, and how it is written there.

`kl` is the divergence of the last epoch, `std` that of the actions. PPO tells the KL
divergence and the entropy's loss, with the price of actions; SAC tells the entropy's
weight.
"""
