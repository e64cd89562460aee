#!/bin/sh
# Compile the kernels of the usual commands where they are kept, by running each on a small peptide.
set -eu
there=$(mktemp -d)
cd "$there"
protochain build NLYIQWLKDGGPSSGRPPPS -o model.pdb
protochain relax model.pdb --json
protochain minimise model.relaxed.pdb --method hybrid --json
protochain validate model.relaxed.pdb --json
protochain simulate model.relaxed.pdb --steps 100 --json
cd /
rm -r "$there"
