"""Physics that a machine's model leaves out: what an effect is (framework), which there are (catalogue), how they look
(sketches).
"""
