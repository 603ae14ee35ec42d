"""HTML pages of measuring, calibrating, learning, verifying and planning; rig.report.pages has their templates."""
