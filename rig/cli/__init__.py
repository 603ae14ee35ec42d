"""One file per command, each with arguments(parser) and run(arguments); they alone see every package, inside run."""
