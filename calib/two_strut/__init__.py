"""The worked example of the configuration-space patent, worked by this code: two struts, four samples, seven
figures.
"""
