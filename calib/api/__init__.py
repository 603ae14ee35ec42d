"""The entry points of calib, one file per verb, called by the commands and by notebooks."""
