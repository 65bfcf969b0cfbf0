// The gradients of window attention, with the weights of a window in private memory.
#import networks::attention::window::window_attention_bwd_body
#import networks::attention::window::window_registers
