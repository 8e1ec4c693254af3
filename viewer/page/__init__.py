"""The light page: a robot of a few hundred triangles and the link, live in any browser.

One process serves it on the loopback interface, under an address with a secret token. It needs no
graphics card and loads nothing from elsewhere. Rerun shows more, and needs more.
"""
