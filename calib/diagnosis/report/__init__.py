"""What a diagnosis hands out: schema, JSON, pages, plots."""
