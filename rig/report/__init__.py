"""What people read: verdicts, pages, plots, views in three dimensions."""
