"""mast-zenoh: the Multi-Agent Security Testbed as real processes on an Eclipse Zenoh mesh."""
