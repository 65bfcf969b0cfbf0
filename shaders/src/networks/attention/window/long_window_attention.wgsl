// Window attention, with the weights of a long window in storage.
#import networks::attention::window::window_attention_body
#import networks::attention::window::window_storage

@group(0) @binding(5) var<storage, read_write> held: array<f32>;
