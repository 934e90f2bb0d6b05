"""Stages of perception in processes of their own: control never waits for them."""
