"""`dualslam whatif`: a recorded run again from one of its steps, with other parameters, beside itself."""
