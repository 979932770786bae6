"""Parts of scripts/fuzz.py: targets (bus.py, mjcf.py), families of chips (family.py, pcl240.py, nova.py), and mutations."""
