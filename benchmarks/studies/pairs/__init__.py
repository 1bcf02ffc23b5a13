"""The finder at every pair: verdicts, thresholds, trust."""
