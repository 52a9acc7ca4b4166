"""The viser panel and its top view; the only folder that knows viser.

Several people may have it open: they see the same, and nothing that their browsers send is trusted.
"""
