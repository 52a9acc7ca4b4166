"""A session under somebody's hands: it runs while its parameters change, goes back in time, and branches.

The engine runs in a thread of its own and knows no viewer.  Whoever wants something says so with a command, which takes
effect between two steps; whoever watches is a `Listener`, is called from that thread, and must not make it wait.
"""
