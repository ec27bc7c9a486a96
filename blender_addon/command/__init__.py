"""The subcommands of `pointmr`, and what they share."""
