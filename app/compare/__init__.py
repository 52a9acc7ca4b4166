"""`dualslam compare A.rrd B.rrd ...`: what differs between recordings, in words, numbers, plots and side by side."""
