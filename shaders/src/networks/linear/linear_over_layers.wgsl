// The matrix products of several linear layers, which add up to one output.
#import networks::linear::strided_operands
#import networks::linear::summed_output
