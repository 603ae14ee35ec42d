"""Files in and out: tables and trees of outside data that are checked, own files written whole, import and export."""
