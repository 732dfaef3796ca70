"""Writes the golden numbers of pcg64.rs: python3 crates/numerics/golden/golden_pcg64.py > crates/numerics/golden/golden_pcg64.rs"""
import numpy as np

print("// Written by golden_pcg64.py; do not edit.")
print("struct Golden { entropy: &'static [u32], units: [f64; 3], integers: [i64; 4], uniform: f64 }")
print("const GOLDEN: &[Golden] = &[")
for entropy in ([0], [42], [7, 1], [1, 2, 3, 4, 5, 6, 7]):
    g = np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy)))
    units = [repr(float(g.uniform())) for _ in range(3)]
    integers = [str(int(g.integers(-9999, 9999))) for _ in range(4)]
    uniform = repr(float(g.uniform(-1000.0, 1000.0)))
    print(f"    Golden {{ entropy: &{entropy}, units: [{', '.join(units)}], "
          f"integers: [{', '.join(integers)}], uniform: {uniform} }},")
print("];")
