"""Tests of starslog: python3 -m unittest discover -s scripts/starslog/tests -t scripts"""
