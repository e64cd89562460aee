"""Where proteins and mechanics meet: rotatable bonds, and a Structure and its hinges as a Chain."""
