"""Many runs of eight tasks, unattended: do all end, how many learn, is what they promise true?

``make soak`` is ``python -m reproduction.soak``.
"""
