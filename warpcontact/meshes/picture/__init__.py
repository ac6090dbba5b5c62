"""Pictures of meshes with their defects marked."""
