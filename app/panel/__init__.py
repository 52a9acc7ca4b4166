"""The panel in the browser: controls, numbers and a top view of a live session; the only folder that knows viser."""
