"""The commands of the bridge: options in, text and exit codes out."""
