"""Interface of proteins and mechanics: rotatable bonds, and a Structure and its hinges as a Chain."""
