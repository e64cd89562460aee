"""The flexible arm of the scene ``manipulator`` by Exudyn: nodes and slopes, not segments and angles."""

import warnings
from itertools import pairwise

import numpy as np
import pytest

from bench.scenes.manipulator import BENDING, EXUDYN, LENGTHS, MASS, START, TORQUES

exudyn = pytest.importorskip("exudyn")
AXIAL = 2.1e11 * 0.04 * 0.01
"""N: EA of the links' steel."""


def arm(elements, steps):
    """End of the arm after a second, by ANCF cable elements and the generalised-alpha method."""
    from exudyn import itemInterface as items

    system = exudyn.SystemContainer().AddSystem()
    last = system.AddMarker(items.MarkerBodyRigid(bodyNumber=system.AddObject(items.ObjectGround())))
    place, angle = np.zeros(2), 0.0
    for k, (length, torque, turn) in enumerate(zip(LENGTHS, TORQUES, START, strict=True)):
        angle += turn
        along = np.array([np.cos(angle), np.sin(angle)])
        nodes = [
            system.AddNode(items.NodePoint2DSlope1(referenceCoordinates=[*(place + along * x), *along]))
            for x in np.linspace(0.0, length, elements + 1)
        ]
        cables = [
            system.AddObject(
                items.ObjectANCFCable2D(
                    length=length / elements, massPerLength=MASS, bendingStiffness=BENDING,
                    axialStiffness=AXIAL, nodeNumbers=list(pair), useReducedOrderIntegration=0,
                )
            )
            for pair in pairwise(nodes)
        ]  # fmt: skip
        root = system.AddMarker(items.MarkerBodyRigid(bodyNumber=cables[0], localPosition=[0, 0, 0]))
        system.AddObject(items.ObjectJointRevolute2D(markerNumbers=[last, root]))
        for marker, sign in ((root, 1.0), *(((last, -1.0),) if k else ())):

            def load(_, t, __, size=sign * torque):
                return [0.0, 0.0, size * np.sin(2.0 * np.pi * t)]

            system.AddLoad(
                items.LoadTorqueVector(markerNumber=marker, loadVector=[0, 0, 0], loadVectorUserFunction=load)
            )
        end = [length / elements, 0, 0]
        last = system.AddMarker(items.MarkerBodyRigid(bodyNumber=cables[-1], localPosition=end))
        place = place + along * length
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = steps, 1.0
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.6
    settings.timeIntegration.newton.absoluteTolerance = 1e-6
    settings.timeIntegration.verboseMode = 0
    settings.solutionSettings.writeSolutionToFile = False
    system.SolveDynamic(settings)
    return np.array(system.GetNodeOutput(nodes[-1], exudyn.OutputVariableType.Position)[:2])


def test_the_arm_of_the_scene_ends_where_exudyn_says():
    with warnings.catch_warnings():
        # Its names of settings change from version to version.
        warnings.simplefilter("ignore", DeprecationWarning)
        found = arm(3, 2000)
    # Of the end with four elements and half the step.
    np.testing.assert_allclose(found, EXUDYN, atol=1e-5)
