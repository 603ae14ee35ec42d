"""How a machine is driven: link, protocols, cameras, driver, journal, the operator's loop, emulators."""
