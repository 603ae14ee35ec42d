"""rig.toml, table by table."""
