"""Mechanisms of bodies, hinges, springs, drives and contacts, in any consistent units."""
