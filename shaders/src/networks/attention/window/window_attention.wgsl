// Window attention, with the weights of a window in private memory.
#import networks::attention::window::window_attention_body
#import networks::attention::window::window_registers
