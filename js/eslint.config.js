/** What eslint looks for: its recommended rules, and a few more that find faults rather than tastes. */

import js from '@eslint/js';
import globals from 'globals';

const FAULTS = {
  'array-callback-return': 'error',
  'consistent-return': 'error',
  'default-case-last': 'error',
  'eqeqeq': 'error',
  'no-constructor-return': 'error',
  'no-eval': 'error', // the content security policy of docs/guide/web.md
  'no-implied-eval': 'error',
  'no-new-func': 'error',
  'no-promise-executor-return': 'error',
  'no-restricted-globals': ['error', 'event', 'name', 'status', 'length', 'top', 'parent'], // of window, and nearly always a slip
  'no-self-compare': 'error',
  'no-shadow': ['error', {hoist: 'never'}],
  'no-throw-literal': 'error',
  'no-unmodified-loop-condition': 'error',
  'no-unreachable-loop': 'error',
  'no-unused-expressions': ['error', {allowShortCircuit: true, allowTernary: true}],
  'no-unused-vars': ['error', {args: 'after-used', argsIgnorePattern: '^_', destructuredArrayIgnorePattern: '^_'}],
  'no-use-before-define': ['error', {functions: false, classes: false, variables: false}],
  'no-useless-assignment': 'error',
  'no-var': 'error',
  'prefer-const': ['error', {destructuring: 'all'}],
  'prefer-promise-reject-errors': 'error',
};

const both = {...globals.browser, ...globals.worker, ...globals.node};

export default [
  {ignores: ['**/node_modules/', '**/types/']},
  js.configs.recommended,
  {rules: FAULTS, linterOptions: {reportUnusedDisableDirectives: 'error'}},
  {files: ['**/*.js'], languageOptions: {globals: both}},
  {files: ['**/*.mjs'], languageOptions: {globals: {...globals.node, window: 'readonly', document: 'readonly'}}},
];
