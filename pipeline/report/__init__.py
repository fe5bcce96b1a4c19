"""Pictures and pages from finished tables; computes no new score."""
