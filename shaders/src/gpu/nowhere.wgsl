// The index that stands for a missing element.
const NOWHERE: u32 = 0xffffffffu;
