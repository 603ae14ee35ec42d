"""The parameters one pose at a time, and what changes while they are learnt."""
