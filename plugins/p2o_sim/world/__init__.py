"""What a scene is made of: triangles, materials, lights, and the plan of a place."""
