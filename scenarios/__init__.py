"""Where data comes from: simulated worlds and real logs, both as a `scenarios.types.Source` of frames."""
