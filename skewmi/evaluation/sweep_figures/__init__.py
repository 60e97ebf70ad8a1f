"""Figures and tables of a sweep's results: what is drawn, of which groups, the sweep file says.

Everything is drawn from tables (`sweep.tables`); what is not in them is told as missing, never made
up. Values that a publication gives stand in the sweep file and are drawn beside ours.
"""
