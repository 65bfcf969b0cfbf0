// The matrix products of linear layers, with one output each.
#import networks::linear::separate_outputs
#import networks::linear::strided_operands
