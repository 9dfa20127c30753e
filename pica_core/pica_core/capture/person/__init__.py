"""People who do not exist, from the identity modes of ICT-FaceKit: face, skin, hair, clothes."""
