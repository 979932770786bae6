"""What scripts/fuzz.py is made of: targets (bus.py, mjcf.py), chip families (family.py, pcl240.py, nova.py), and how a run goes."""
